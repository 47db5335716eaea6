"""The search for the hypotheses that explain a recording, and for their alternatives."""
