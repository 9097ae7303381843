"""Response curves by continuation."""
