"""A log onto Zenoh: published when due, by commands over Zenoh and from the keyboard."""
