"""What a model leaves that no column explains: slow, random and varying noise, oscillations."""
