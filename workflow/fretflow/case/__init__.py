"""Case files: their sections, values with units, and the parsed configuration."""
