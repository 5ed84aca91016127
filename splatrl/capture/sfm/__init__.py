"""Structure from motion with COLMAP, for the stage ``poses``: it runs in a process of its own."""
