"""Checks that hold the commands against the motion, and the motion against the commands."""
