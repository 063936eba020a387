"""Commands of `rcmservo`."""
