"""Give ArduPilot a lawn mower, arm it, and let it sail in Auto.

Docs: docs/tutorials/ardurover.md. It needs an autopilot that sends MAVLink to
udp://127.0.0.1:14560, or to the port of another connection that is named.
"""

import sys
import time

from pymavlink import mavutil

from twin.logs.datum import Plane

PLACE = sys.argv[1] if len(sys.argv) > 1 else "udpin:127.0.0.1:14560"
HOME = Plane(59.9, 10.7)
LENGTH, APART, LANES = 250.0, 50.0, 3  # m

corners = [(10.0, 0.0)]
for lane in range(LANES):
    ends = [10.0, LENGTH] if lane % 2 == 0 else [LENGTH, 10.0]
    corners += [(north, lane * APART) for north in ends]
# the first item of a mission is the home of the autopilot, which is not sailed to
points = [HOME.degrees(*corner) for corner in (corners[0], *corners)]

link = mavutil.mavlink_connection(PLACE, source_system=255)
link.wait_heartbeat()
target = link.target_system, link.target_component

link.mav.mission_count_send(*target, len(points))
answers = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
while (item := link.recv_match(type=answers, blocking=True)).get_type() != "MISSION_ACK":
    place = [round(1e7 * degrees) for degrees in points[item.seq]]
    link.mav.mission_item_int_send(*target, item.seq, 3, 16, 0, 1, 0, 0, 0, 0, *place, 0)
print(f"mission of {len(corners)} way points")

while not link.motors_armed():
    link.set_mode("AUTO")
    link.mav.command_long_send(
        *target, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0
    )
    end = time.monotonic() + 1.0
    while time.monotonic() < end:  # says why, when it does not want to
        if said := link.recv_match(type="STATUSTEXT", blocking=True, timeout=0.2):
            print(said.text)
print("armed: it sails")

while item := link.recv_match(type="MISSION_ITEM_REACHED", blocking=True, timeout=60.0):
    print(f"way point {item.seq} of {len(corners)}")
    if item.seq == len(corners):
        break
link.close()
