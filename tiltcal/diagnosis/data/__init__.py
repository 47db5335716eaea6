"""What was read and what the model predicts, channel by channel, on a table or by hand."""
