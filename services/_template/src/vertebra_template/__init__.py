"""The template of a service: it greets whoever is named on a key."""
