"""What comes over the wire of a boat, live or from a file: messages as rows for its twin.

May import what twin.logs may.
"""
