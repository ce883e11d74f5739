"""MAVLink 2, the protocol of PX4 and ArduPilot: send obstacle distances and receive poses [MAVLink]."""
