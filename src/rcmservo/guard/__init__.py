"""What may move, and why not: phases and causes, checks for faults, the last gate, the watchdog."""
