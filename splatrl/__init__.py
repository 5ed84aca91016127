"""splatrl: reinforcement learning for robots that see a captured Gaussian splatting scene."""
