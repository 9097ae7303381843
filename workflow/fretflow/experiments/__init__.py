"""What was measured and how the model predicts it, one folder a kind."""
