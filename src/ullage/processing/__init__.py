"""What the frames tell, blind to how they were made."""
