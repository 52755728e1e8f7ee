"""The REST interface of the live service."""
