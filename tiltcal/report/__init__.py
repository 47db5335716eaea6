"""The HTML reports: offline files that contain their plots."""
