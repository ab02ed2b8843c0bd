"""What a view shows: a simulated run, a log, or a feed, followed by a twin.

May import twin.live.protocols, twin.sim and below.
"""
