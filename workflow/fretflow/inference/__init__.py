"""Does the model explain a recording; if not, where do they part, and which physics was left out."""
