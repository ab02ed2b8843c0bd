"""Logs of autopilots: ArduPilot's DataFlash files (.BIN) and MAVLink telemetry (.tlog).

Receiver, attitude, IMU and servo outputs become the columns of a log.
May import twin.channels, twin.particulars and the other modules of twin.logs but log.py.
"""
