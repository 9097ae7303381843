"""Concealed recordings of a fretting rig, from a simulator that shares nothing with the models it tests."""
