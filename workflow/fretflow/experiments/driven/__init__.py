"""Joints that a measured motion drives."""
