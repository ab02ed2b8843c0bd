"""The live 3-D view in a browser.

May import twin.live.sessions and below.
"""
