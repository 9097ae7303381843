"""Pictures and reports of result files."""
