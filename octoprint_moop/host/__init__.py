"""What OctoPrint loads: hooks, settings and routes. Thin; the work is done in machine and core."""
