"""Options of commands: their list, their help, and suggestions for misspelt ones."""
