"""What evaluated agents leave for other programs: videos of their episodes, and data sets.

May import all of ``twin.agents``; nothing there may import it.
"""
