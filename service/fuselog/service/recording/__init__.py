"""Zenoh into a log: what comes waits in bounded memory for one thread that writes."""
