"""The live view: protocols, sessions, and their page in a browser.

May import twin.sim and below.
"""
