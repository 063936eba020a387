"""What a command tells while a person waits for it."""
