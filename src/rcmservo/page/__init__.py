"""The operator's page: a client of live, as any other."""
