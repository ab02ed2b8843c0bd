"""Everything that steers: classical controllers, trained policies, and how they are compared."""
