"""Commands for a lab: bring-up, emulation and the operator's page."""
