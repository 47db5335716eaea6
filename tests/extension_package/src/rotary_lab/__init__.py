"""What a laboratory adds to tiltcal: an effect, a table with four axes and a method."""
