"""What is out there: materials, geometry, world files."""
