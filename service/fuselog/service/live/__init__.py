"""The live service: samples from Zenoh through filters to Zenoh."""
