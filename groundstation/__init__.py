"""The command centre: picture of the world, assignment, one-way broadcast."""
