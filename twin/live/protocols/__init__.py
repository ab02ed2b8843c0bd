"""How data come in and go out: UDP and serial feeds, NMEA 0183, MAVLink, replay.

May import twin.logs and twin.channels.
"""
