"""Effects of the stage environment."""
