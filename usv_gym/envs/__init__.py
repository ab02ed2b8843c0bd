"""The Gymnasium environment: tasks, episodes, observations, pictures, vector environment.

May import everything else in usv_gym.
"""
