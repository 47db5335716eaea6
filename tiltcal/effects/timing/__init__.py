"""Effects of the stage timing."""
