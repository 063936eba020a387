"""Commands for studies and tuning."""
