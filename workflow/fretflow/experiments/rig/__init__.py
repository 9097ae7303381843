"""Recordings of the fretting rig."""
