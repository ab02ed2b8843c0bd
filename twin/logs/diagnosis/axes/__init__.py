"""A three-axis IMU against all that shows its motion: evidence, simple faults, the verdict.

Linear equations tie rates and forces to compass, velocities, gravity and AHRS. May import the
other detectors' estimators and findings.
"""
