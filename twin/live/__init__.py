"""The twin of a boat that sails now: what comes over the wire, and what is shown of it."""
