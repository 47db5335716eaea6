"""Effects of the stage data."""
