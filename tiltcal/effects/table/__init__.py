"""Effects of the stage table."""
