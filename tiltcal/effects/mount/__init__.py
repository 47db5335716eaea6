"""Effects of the stage mount."""
