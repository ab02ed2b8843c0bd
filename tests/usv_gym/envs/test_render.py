"""Pictures: what they show, that they change nothing, and what happens without their library."""

import math
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import usv_gym
from twin.sim.wrapper import TwinObservation
from usv_gym import Fault, SensorSuite
from usv_gym.envs.env import USVEnv
from usv_gym.envs.render import Painter, Renderer
from usv_gym.envs.scene import Scene, ellipses, outlines

pygame = pytest.importorskip("pygame", reason="needs the extra render")
AHEAD = np.array([0.8, 0.1], dtype=np.float32)
PURPLE, RED, BAND = (170, 68, 130), (213, 94, 0), (248, 216, 178)


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def made(seed: int = 0, **options: Any) -> USVEnv:
    options = {"render_mode": "rgb_array", "twin": None} | options
    env = gym.make("USVTwin-v0", **options).unwrapped
    assert isinstance(env, USVEnv)
    env.reset(seed=seed)
    return env


def sail(env: gym.Env[Any, Any], seconds: float) -> None:
    for _ in range(round(seconds * 20)):
        env.step(AHEAD)


def scene(env: USVEnv) -> Scene:
    assert env.renderer
    return env.renderer.scene(0)


def picture(env: gym.Env[Any, Any]) -> np.ndarray:
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    return frame


def count(frame: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int(np.all(np.abs(frame.astype(int) - colour) < 12, axis=-1).sum())


# ------------------------------------------------- frames


@pytest.mark.parametrize("size", [(720, 720), (501, 401), (400, 900)])
def test_a_frame_is_an_image_of_the_size_asked_for(size: tuple[int, int]) -> None:
    frame = picture(made(render_size=size))
    assert frame.shape == (size[1], size[0], 3) and frame.dtype == np.uint8
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 20
    assert not pygame.display.get_init()  # no screen is needed


def test_frames_are_the_readers_own_and_move_with_the_boat() -> None:
    env = made()
    before = picture(env)
    kept = before.copy()
    sail(env, 0.5)
    after = picture(env)
    assert np.array_equal(before, kept)
    assert (before != after).any(axis=-1).sum() > 500


@pytest.mark.parametrize("vessel", usv_gym.vessel_names())
def test_every_vessel_is_painted(vessel: str) -> None:
    env = made(vessel=vessel)
    sail(env, 0.2)
    assert count(picture(env), (92, 99, 105)) > 100


def test_a_catamaran_has_two_hulls_and_a_deck_within_its_beam() -> None:
    for name, count in {"otter": 3, "wamv16": 3, "usv75": 1, "kvlcc2_l7": 1}.items():
        vessel = usv_gym.Vessel.load(name)
        shapes = outlines(vessel)
        assert len(shapes) == count
        points = np.vstack(shapes)
        assert np.ptp(points[:, 1]) == pytest.approx(vessel.values["beam"])
        bows = {round(float(shape[np.argmax(shape[:, 0]), 1]), 6) for shape in shapes[:2]}
        assert (0.0 in bows) == (count == 1)


def test_north_is_up_and_east_is_right() -> None:
    env = made(sea="calm", twin=None, task="free")
    shown = scene(env)
    object.__setattr__(shown, "fixes", shown.view + np.array([[15.0, 25.0]]))
    east = Painter((720, 720)).paint(shown)[:, 360:]
    rows, _ = np.nonzero(np.all(np.abs(east.astype(int) - PURPLE) < 12, axis=-1))
    assert len(rows) > 10 and rows.mean() < 360


# ------------------------------------------------- the GPS and its loss


def test_fixes_stop_where_the_gps_is_lost_and_go_on_after_it() -> None:
    env = made(faults=[Fault("gps", 5.0, 30.0)], task="free")
    sail(env, 4.9)
    before, frame = scene(env), picture(env)
    assert not before.gps_lost and len(before.fixes) >= 9
    assert count(frame[:100], RED) == 0
    sail(env, 20.0)
    lost = scene(env)
    assert lost.gps_lost and lost.gps_age == pytest.approx(24.9 - 5.0, abs=0.11)
    assert len(lost.fixes) <= len(before.fixes) + 1
    assert count(picture(env)[:100], RED) > 500
    sail(env, 13.0)
    assert not scene(env).gps_lost and len(scene(env).fixes) > len(lost.fixes) + 3


def test_a_slow_gps_is_not_a_lost_one() -> None:
    env = made(suite=SensorSuite(gps_rate=1.0), sea="calm", task="free")
    said = []
    for _ in range(100):
        env.step(AHEAD)
        said.append(scene(env).gps_lost)
    assert not any(said)
    assert 4 <= len(scene(env).fixes) <= 6


def test_a_new_episode_forgets_the_track_of_the_old() -> None:
    env = made()
    sail(env, 5.0)
    assert len(scene(env).track) > 10 and len(scene(env).fixes) > 5
    env.reset()
    assert len(scene(env).track) <= 2 and len(scene(env).fixes) <= 1


# ------------------------------------------------- wind, waves, rewards


def test_wind_and_waves_are_those_of_the_sea() -> None:
    env = made(hs=1.5, wind=8.0, wind_from_deg=90.0)
    shown = scene(env)
    assert shown.hs == pytest.approx(1.5, rel=1e-6)
    assert math.degrees(shown.wind_from) == pytest.approx(90.0)
    assert math.degrees(shown.wave_to) % 360.0 == pytest.approx(270.0)
    assert 4.0 < shown.wind < 12.0
    drawn = scene(made(sea="calm|4", seed=1))
    assert math.isfinite(drawn.wave_to) and drawn.hs in (0.0, pytest.approx(2.5, rel=1e-6))
    calm = scene(made(sea="calm"))
    assert calm.wind == calm.hs == 0.0


def test_the_reward_is_that_of_the_step() -> None:
    env = made()
    reward = env.step(AHEAD)[1]
    assert scene(env).reward == pytest.approx(reward)
    assert scene(made(task="free")).reward is None


# ------------------------------------------------- the twin


def test_the_band_of_the_twin_grows_with_the_horizon() -> None:
    env = made(twin="ukf")
    sail(env, 12.0)
    overlay = scene(env).overlay
    assert overlay and overlay.horizons.tolist() == [1.0, 2.0, 5.0, 10.0]
    times, places, covs = overlay.interpolate()
    shapes = ellipses(places, covs)
    width = np.linalg.norm(shapes - places[:, None], axis=-1).max(axis=1)
    assert times[0] == 0.0 and times[-1] == 10.0
    at = np.searchsorted(times, overlay.horizons)
    assert (np.diff(width[at]) > 0.0).all() and width[-1] > 2.0 * width[0]
    assert np.allclose(places[at], overlay.ahead[:, :2], atol=1e-9)
    assert math.dist(overlay.state[:2], scene(env).state[:2]) < 5.0
    assert count(picture(env), BAND) > 1500
    assert scene(made()).overlay is None and count(picture(made()), BAND) == 0


def test_the_wrapper_brings_its_twin_into_the_picture() -> None:
    env = TwinObservation(gym.make("USVTwin-v0", twin=None, render_mode="rgb_array"), "ukf")
    native = made(twin="ukf")
    env.reset(seed=0)
    for _ in range(20):
        env.step(AHEAD)
    sail(native, 1.0)
    assert np.array_equal(picture(env), picture(native))


# ------------------------------------------------- Gymnasium's rules


@pytest.mark.parametrize("mode", ["rgb_array", "human"])
@pytest.mark.parametrize("twin", [None, "ukf"])
def test_observations_are_the_same_with_pictures_and_without(mode: str, twin: Any) -> None:
    plain = gym.make("USVTwin-v0", twin=twin, sea="4", faults="gps10@1")
    shown = gym.make("USVTwin-v0", twin=twin, sea="4", faults="gps10@1", render_mode=mode)
    if mode == "human":
        shown.unwrapped.renderer._window.fps = 0  # type: ignore[attr-defined]
    for seed in (3, None):
        (a, _), (b, _) = plain.reset(seed=seed), shown.reset(seed=seed)
        for _ in range(40):
            assert a.tobytes() == b.tobytes()
            a, *rest = plain.step(AHEAD)
            b, *others = shown.step(AHEAD)
            shown.render()
            assert rest == others
    shown.close()


def test_without_a_mode_it_warns_and_returns_nothing() -> None:
    env = made(render_mode=None)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


def test_before_the_reset_there_is_no_picture() -> None:
    for env in (
        USVEnv(render_mode="rgb_array"),
        gym.make_vec("USVTwin-v0", 2, twin=None, render_mode="rgb_array"),
    ):
        with pytest.raises(gym.error.ResetNeeded, match="render"):
            env.render()


@pytest.mark.parametrize(
    "size",
    [(399, 720), (720.5, 720), "big", (5000, 720), (720, 720, 3), (math.nan, 720)],
)
def test_sizes_that_cannot_be_are_refused(size: Any) -> None:
    with pytest.raises(ValueError, match="render_size"):
        made(render_size=size)


def test_a_missing_library_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r"pip install 'usv-twin\[render\]'"):
        made()
    made(render_mode=None)


# ------------------------------------------------- many boats


def test_many_boats_have_a_picture_each_as_they_have_alone() -> None:
    envs = gym.make_vec(
        "USVTwin-v0", 3, twin="ukf", render_mode="rgb_array", render_size=(400, 400)
    )
    envs.reset(seed=5)
    alone = made(seed=6, twin="ukf", render_size=(400, 400))
    for _ in range(20):
        envs.step(np.tile(AHEAD, (3, 1)))
    sail(alone, 1.0)
    frames = envs.render()
    assert frames is not None and len(frames) == 3
    assert np.array_equal(np.asarray(frames[1]), picture(alone))
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    tracks = [len(envs.unwrapped.renderer.scene(i).track) for i in range(3)]  # type: ignore
    assert tracks[1] < 3 < tracks[0]
    envs.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_tracks_begin_again_where_boats_reset_themselves(mode: str) -> None:
    envs = gym.make_vec(
        "USVTwin-v0",
        2,
        twin=None,
        render_mode="rgb_array",
        max_episode_steps=60,
        autoreset_mode=mode,
    )
    envs.reset(seed=0)
    for _ in range(64):
        envs.step(np.tile(AHEAD, (2, 1)))
    renderer = envs.unwrapped.renderer  # type: ignore[attr-defined]
    assert isinstance(renderer, Renderer)
    assert all(len(renderer.scene(i).track) < 10 for i in range(2))


def test_stable_baselines_gets_the_pictures() -> None:
    pytest.importorskip("stable_baselines3")
    from usv_gym.envs.sb3 import SB3VecEnv

    envs = SB3VecEnv(2, twin=None, render_mode="rgb_array", render_size=(400, 400))
    envs.reset()
    assert [np.shape(image) for image in envs.get_images()] == [(400, 400, 3)] * 2
    assert np.shape(envs.render()) == (800, 400, 3)
    envs.close()


# ------------------------------------------------- videos and windows


def test_a_video_is_recorded(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="RecordVideo needs moviepy")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # moviepy's own
        from moviepy import VideoFileClip
    env = gym.make("USVTwin-v0", twin="ukf", render_mode="rgb_array", max_episode_steps=30)
    env = gym.wrappers.RecordVideo(env, str(tmp_path / "videos"), disable_logger=True)
    env.reset(seed=0)
    for _ in range(30):
        env.step(AHEAD)
    env.close()
    (path,) = (tmp_path / "videos").glob("*.mp4")
    clip = VideoFileClip(str(path))
    assert clip.size == [720, 720] and clip.fps == 20.0
    assert clip.duration == pytest.approx(31 / 20.0, abs=0.06)
    assert np.ptp(clip.get_frame(1.0)) > 100
    clip.close()


def test_a_window_shows_each_step_and_env_close_closes_it() -> None:
    env = made(render_mode="human", twin="ukf", render_size=(400, 400))
    assert pygame.display.get_init() and pygame.display.get_surface().get_size() == (400, 400)
    first = pygame.surfarray.array3d(pygame.display.get_surface())
    sail(env, 0.5)
    assert (pygame.surfarray.array3d(pygame.display.get_surface()) != first).any()
    assert env.render() is None
    env.close()
    assert not pygame.display.get_init()
    env.close()


def test_a_window_that_its_user_closes_ends_nothing_else() -> None:
    env = made(render_mode="human", render_size=(400, 400))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    sail(env, 0.5)
    assert not pygame.display.get_init()
    env.reset()
    env.render()
    assert not pygame.display.get_init()
    env.close()


def test_without_a_screen_a_window_is_refused_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "none such")
    with pytest.raises(gym.error.Error, match="rgb_array"):
        made(render_mode="human")
