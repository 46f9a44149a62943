"""What is learnt from rewards: PPO and GAIL."""
