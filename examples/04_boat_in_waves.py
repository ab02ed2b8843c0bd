"""The boat in its sea: heave, roll and pitch with six degrees of freedom, as a picture.

Run ``python examples/04_boat_in_waves.py [picture.png]``.
"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from usv_gym import SeaState, Vessel
from usv_gym.physics import frames
from usv_gym.vessel.geometry import boat_of
from usv_gym.world.realisation import Sea
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.simulation import Simulation
from usv_kernel.channels import SENSOR_CHANNELS

SECONDS, AT = 60.0, 41.0


def sail(vessel: Vessel, state: SeaState) -> tuple[Simulation, np.ndarray, np.ndarray]:
    """Return the simulation, and at 20 Hz the true states and the measurements."""
    simulation = Simulation(1, vessel, state, dof=6, suite=SensorSuite.perfect())
    simulation.reset([0], [np.random.default_rng(3)])
    states, seen = [], []
    for _ in range(round(SECONDS / simulation.dt)):
        heading, rate = simulation.state[0, [frames.PSI, frames.R]]
        helm = np.clip(-0.6 * heading - 0.6 * rate, -vessel.helm_max, vessel.helm_max)
        simulation.step(vessel.command(vessel.values["shaft_speed_manoeuvring"], helm)[None])
        states.append(simulation.state[0].copy())
        seen.append(simulation.z[0].copy())
    return simulation, np.array(states), np.array(seen)


def draw_sea(ax, sea: Sea, vessel: Vessel, state: np.ndarray, t: float) -> None:
    """Draw the surface and the boat on it; north to the right, east towards the reader, up."""
    x, y, z = state[:3]
    side = 1.6 * vessel.values["length_overall"]
    north, east = np.meshgrid(np.linspace(-side, side, 121), np.linspace(-side, side, 121))
    height = sea.elevation(x + north, y + east, t)
    light = LightSource(azdeg=300.0, altdeg=35.0)
    shade = light.shade(height, plt.get_cmap("ocean"), vmin=-4.0, vmax=3.0, vert_exag=4.0)
    ax.plot_surface(north, -east, height, facecolors=shade, rcount=121, ccount=121, shade=False)
    attitude = state[[frames.PHI, frames.THETA, frames.PSI]]
    boat = boat_of(vessel)
    for part in boat.parts:
        corners = part.mesh.moved(boat.position_of(part)).vertices
        turned = np.array([frames.rotate(*attitude, *corner) for corner in corners])
        faces = (turned * [1, -1, -1] + [0, 0, -z])[part.mesh.faces]
        colour = np.array(part.colour) / 255.0
        # matplotlib cannot intersect surfaces: the boat is drawn on top of the sea
        ax.add_collection3d(Poly3DCollection(faces, facecolors=colour, shade=True, zorder=10))
    ax.computed_zorder = False
    ax.set(xlim=(-side, side), ylim=(-side, side), zlim=(-1.5, 2.0))
    ax.set_box_aspect((2 * side, 2 * side, 3.5), zoom=1.02)
    ax.view_init(elev=24.0, azim=-62.0)
    ax.set_axis_off()


def main(path: str = "boat_in_waves.png") -> None:
    """Simulate a minute and draw it."""
    vessel = Vessel.load("usv75")
    state = SeaState.named("3").replace(wind_from=np.radians(35.0), spreading=4.0)
    simulation, states, seen = sail(vessel, state)
    sea = Sea(simulation.waves[0], simulation.gusts[0], simulation.weather[0])
    t = simulation.dt * np.arange(1, len(states) + 1)
    now = round(AT / simulation.dt) - 1

    figure = plt.figure(figsize=(11.0, 4.6))
    grid = figure.add_gridspec(3, 1, left=0.62, right=0.985, top=0.87, bottom=0.11, hspace=0.55)
    draw_sea(
        figure.add_axes((-0.075, -0.2, 0.66, 1.4), projection="3d"),
        sea,
        vessel,
        states[now],
        t[now],
    )
    surface = sea.elevation(states[:, frames.X], states[:, frames.Y], t)
    axes = [figure.add_subplot(grid[i, 0]) for i in range(3)]
    axes[0].plot(t, surface, color="#56b4e9", label="surface")
    axes[0].plot(t, -states[:, frames.Z], color="#d55e00", label="boat")
    axes[0].set_ylabel("height (m)")
    axes[1].plot(t, np.degrees(states[:, frames.PHI]), color="#0072b2", label="roll")
    axes[1].plot(t, np.degrees(states[:, frames.THETA]), color="#e69f00", label="pitch")
    axes[1].set_ylabel("angle (deg)")
    for name, colour in (("accel_x_mps2", "#009e73"), ("accel_y_mps2", "#cc79a7")):
        label = "forward" if "_x_" in name else "starboard"
        axes[2].plot(t, seen[:, SENSOR_CHANNELS.index(name)], color=colour, label=label)
    axes[2].set(ylabel="accelerometer (m/s$^2$)", xlabel="time (s)")
    for ax in axes:
        ax.set_xlim(AT - 20.0, AT + 15.0)
        ax.axvline(t[now], color="0.6", lw=0.8)
        ax.grid(alpha=0.3)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, fontsize=8, frameon=False)
    figure.align_ylabels(axes)
    figure.suptitle(f"{vessel.title} in sea state 3, six degrees of freedom", fontsize=11, y=0.97)
    figure.savefig(path, dpi=85)
    print(f"roll {np.degrees(states[:, frames.PHI].std()):.1f} deg, written to {path}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
