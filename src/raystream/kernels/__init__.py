"""Device functions that every structure shares: ray set-up, slab test, triangle test, queries."""
