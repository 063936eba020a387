"""Settings found by study: a search over some of a method's numbers, and a trial of what it found
on scenes that it has not seen.
"""
