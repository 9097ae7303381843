"""Model reduction: fixed-interface modes and Craig-Bampton."""
