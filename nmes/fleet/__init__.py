"""Many worlds on many processes and machines: workers of one host, surveys, and how hosts of a fleet fare."""
