"""Zenoh, FastAPI, threads and the command line."""
