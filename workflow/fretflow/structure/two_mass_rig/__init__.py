"""The lumped test rig and the joint that it forms with the specimens."""
