"""Runs as pictures in Rerun."""
