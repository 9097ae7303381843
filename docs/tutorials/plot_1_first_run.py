"""
First run
=========

A first run.
"""
import fretflow as ff

print(ff.__all__)
