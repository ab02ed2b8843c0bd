"""What ``usv-twin validate`` computes about ship and sea.

May import everything else in usv_gym.
"""
