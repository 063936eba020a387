"""What the methods of others, which ours are compared with, are made of."""
