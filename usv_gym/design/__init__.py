"""New vessels from main particulars, and checks of vessel files.

May import usv_gym.physics, vessel, world and manoeuvring.
"""
