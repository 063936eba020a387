"""Camera drivers, and emulated cameras for tests without hardware."""
