"""New vessels from main particulars, and inspection of vessels.

May import usv_gym.physics, vessel, world and manoeuvring.
"""
