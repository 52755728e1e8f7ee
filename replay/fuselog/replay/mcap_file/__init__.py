"""One MCAP file: from its bytes to messages, and from messages to bytes."""
