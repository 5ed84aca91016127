"""Scripted teachers that know the state: what tasks demonstrate, and label a policy's own states with."""
