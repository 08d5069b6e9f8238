"""Which recordings a diagnosis can use, where the gap lies in them, what to record next."""
