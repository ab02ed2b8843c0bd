"""Ship and sea as the physics behind an autopilot's software in the loop.

Packets of ArduPilot's JSON interface, the backend that answers them, and parameters for the
autopilot from trials. Nothing here speaks MAVLink. May import all of usv_gym but environments.
"""
