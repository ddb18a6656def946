"""Expected against observed: how far apart, what it means, and what it is called."""
