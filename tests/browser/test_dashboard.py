"""The dashboard in a real Chromium, on a real gateway and router, with a robot made by the test."""

from __future__ import annotations

import asyncio
import time
from typing import Any, Final

import pytest
from playwright.async_api import Browser, Locator, Page, expect

from vertebra.errors import CommandRefusedError
from vertebra.testing.bus_suite import eventually

from .conftest import screenshot, watch
from .lab import SIDE, SQUARE_RGB, WALL_RGB, Lab

pytestmark = pytest.mark.browser

BACK_WITHIN_MS: Final = 5000
NOTICED_WITHIN_MS: Final = 6000
LIVE: Final = ".camera[data-state=live]"

SEEN: Final = """() => {
  const card = document.querySelector(".camera");
  const canvas = card.querySelector("canvas");
  const { width, height } = canvas;
  const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
  const at = (x, y) => [...data.slice(4 * (y * width + x), 4 * (y * width + x) + 4)];
  const columns = [...Array(width).keys()].filter((x) => at(x, 120)[0] > 200);
  const box = card.querySelector("rect.box");
  return {
    size: [width, height],
    corners: [at(0, 0), at(width - 1, 0), at(0, height - 1), at(width - 1, height - 1)],
    wall: at(5, 50),
    square: at(columns[0] + 5, 120),
    left: columns[0],
    right: columns.at(-1),
    box: box && ["x", "y", "width", "height"].map((name) => Number(box.getAttribute(name))),
  };
}"""

WATCH_JOINTS: Final = """
  window.jointsLived = false;
  new MutationObserver(() => {
    window.jointsLived ||= document.querySelector(".joints[data-state=live]") !== null;
  }).observe(document, { subtree: true, childList: true, attributes: true });
"""


async def seen(page: Page) -> dict[str, Any]:
    """Return what the camera card shows at one instant: pixels and box."""
    found: dict[str, Any] = await page.evaluate(SEEN)
    return found


def joint(page: Page, name: str) -> Locator:
    return page.locator(f".joint:has(input[data-joint={name}])")


async def drag(page: Page, slider: Locator, start: float, end: float, steps: int) -> None:
    """Drag from one fraction of the range to another."""
    await slider.scroll_into_view_if_needed()
    box = await slider.bounding_box()
    assert box is not None
    thumb = 20.0

    def at(fraction: float) -> tuple[float, float]:
        x = box["x"] + thumb / 2 + fraction * (box["width"] - thumb)
        return x, box["y"] + box["height"] / 2

    await page.mouse.move(*at(start))
    await page.mouse.down()
    for step in range(1, steps + 1):
        await page.mouse.move(*at(start + (end - start) * step / steps))
        await asyncio.sleep(0.01)
    await page.mouse.up()


async def test_camera_shows_the_right_pixels(lab: Lab, page: Page) -> None:
    async with lab.robot() as robot:
        robot.still = True
        await expect(page.locator(LIVE)).to_be_visible()
        found = await seen(page)
    assert found["size"] == [320, 240]
    assert found["corners"] == [
        [255, 0, 0, 255],
        [0, 255, 0, 255],
        [0, 0, 255, 255],
        [1, 2, 3, 255],
    ]
    assert found["wall"] == [*WALL_RGB, 255]
    assert found["square"] == [*SQUARE_RGB, 255]


async def test_box_stays_on_the_face_while_it_moves(lab: Lab, page: Page) -> None:
    async with lab.robot():
        await expect(page.locator("rect.box")).to_be_visible()
        places = []
        for _ in range(60):
            found = await seen(page)
            assert found["box"] == [found["left"], 100, SIDE, SIDE]
            assert found["right"] - found["left"] == SIDE - 1
            places.append(found["left"])
            await asyncio.sleep(0.02)
        assert max(places) - min(places) > 100, "it did move"
        await expect(page.locator(".faces text")).to_have_text("#7  88 %")
        await expect(page.locator(".caption")).to_have_text("1 face in this image: #7")
        await screenshot(page, "desk")


async def test_picture_goes_on_without_boxes_when_nobody_looks_for_faces(
    lab: Lab, page: Page
) -> None:
    async with lab.robot() as robot:
        await expect(page.locator("rect.box")).to_be_visible()
        robot.blind = True
        await expect(page.locator("rect.box")).to_have_count(0)
        before = (await seen(page))["left"]
        for _ in range(100):
            if (await seen(page))["left"] != before:
                break
            await asyncio.sleep(0.02)
        assert (await seen(page))["box"] is None
        await expect(page.locator(LIVE)).to_be_visible()
        robot.blind = False
        await expect(page.locator("rect.box")).to_be_visible()


async def test_streams_and_services_are_listed(lab: Lab, page: Page) -> None:
    async with lab.robot():
        await expect(page.locator(LIVE)).to_be_visible()
        row = page.locator("#streams tr:has-text('vizzy/camera/left/')").first
        await expect(row).to_have_attribute("data-state", "live")
        await expect(row.locator("td").first).to_have_text("Faces/1")
        await asyncio.sleep(2.0)  # for the rate to be measured
        rate_hz, age_ms, dropped, lost = [
            float(await row.locator("td").nth(column).inner_text()) for column in range(1, 5)
        ]
        assert 10 < rate_hz < 40
        assert 0 < age_ms < 1000
        assert dropped >= 0
        assert lost >= 0
        service = page.locator("tr[data-service=gateway]")
        await expect(service).to_have_attribute("data-state", "ok")


async def test_damaged_data_are_reported_and_the_picture_goes_on(lab: Lab, page: Page) -> None:
    async with lab.robot() as robot:
        await expect(page.locator(LIVE)).to_be_visible()
        for _ in range(2):
            robot.publish_rubbish()
            await asyncio.sleep(0.1)
        problem = page.locator("#problems li")
        await expect(problem).to_contain_text("a sample of vizzy/imu: a frame begins with")
        await expect(problem).to_contain_text("(2 times)")
        await expect(page.locator(LIVE)).to_be_visible()
        await page.locator("#problems button").click()
        await expect(page.locator("#problems")).to_be_hidden()


async def test_dragging_a_slider_moves_the_joint_by_the_newest_value_only(
    lab: Lab, page: Page
) -> None:
    async with lab.robot() as robot:
        robot.delay_s = 0.2
        yaw = joint(page, "neck_yaw")
        slider = yaw.locator("input")
        await expect(slider).to_be_enabled()
        await expect(yaw.locator(".measured")).to_have_text("at 0.0°")
        await expect(page.locator(".readings")).to_have_count(0)
        began_s = time.monotonic()
        await drag(page, slider, 0.5, 0.9, steps=60)
        wanted = float(await slider.input_value())
        assert 20 < wanted < 28
        await eventually(lambda: robot.moves[-1]["positions_deg"] == {"neck_yaw": wanted})
        await expect(yaw.locator(".measured")).to_have_text(f"at {wanted:.1f}°")
        await expect(yaw.locator(".target")).to_have_text(f"to {wanted:.1f}°")
        assert all(move["wait"] is False for move in robot.moves)
        assert robot.most_moves_at_once == 1
        assert 2 <= len(robot.moves) <= 1 + (time.monotonic() - began_s) / robot.delay_s
        moved = len(robot.moves)
        await asyncio.sleep(0.5)
        assert len(robot.moves) == moved


async def test_refusal_is_shown_beside_the_slider_until_the_next_move(lab: Lab, page: Page) -> None:
    async with lab.robot() as robot:
        pitch = joint(page, "neck_pitch")
        slider = pitch.locator("input")
        await expect(slider).to_be_enabled()
        robot.failure = CommandRefusedError("neck_pitch is locked by its brake")
        await slider.focus()
        await page.keyboard.press("ArrowRight")
        await expect(pitch.locator(".error")).to_have_text("neck_pitch is locked by its brake")
        await expect(joint(page, "neck_yaw").locator(".error")).to_be_hidden()
        await expect(pitch.locator(".target")).to_have_text("")
        await screenshot(page, "refused")
        robot.failure = None
        await expect(slider).to_be_enabled()
        await slider.focus()
        await page.keyboard.press("ArrowRight")
        await expect(pitch.locator(".error")).to_be_hidden()


async def test_value_beyond_the_limit_is_refused_with_the_limit(lab: Lab, page: Page) -> None:
    async with lab.robot() as robot:
        roll = joint(page, "neck_roll")
        slider = roll.locator("input")
        await expect(slider).to_be_enabled()
        # Nobody can drag a slider beyond its end; a page with limits of yesterday can.
        await slider.evaluate("(input) => { input.max = 99; }")
        await slider.fill("99")
        await expect(roll.locator(".error")).to_contain_text("99")
        await expect(roll.locator(".error")).to_contain_text("30")
        assert robot.moves == []


async def test_keyboard_moves_a_joint_and_stops_the_robot(lab: Lab, page: Page) -> None:
    async with lab.robot() as robot:
        slider = joint(page, "neck_pitch").locator("input")
        await expect(slider).to_be_enabled()
        for _ in range(20):
            await page.keyboard.press("Tab")
            if await slider.evaluate("(input) => input === document.activeElement"):
                break
        await page.keyboard.press("ArrowRight")
        await page.keyboard.press("ArrowRight")
        wanted = float(await slider.input_value())
        assert wanted > 0
        await eventually(
            lambda: robot.moves[-1:] == [{"positions_deg": {"neck_pitch": wanted}, "wait": False}]
        )
        await page.keyboard.press("Escape")
        await eventually(lambda: robot.stops >= 1)
        await expect(joint(page, "neck_pitch").locator(".target")).to_have_text("")


async def test_stop_forgets_moves_that_wait_and_comes_after_the_one_under_way(
    lab: Lab, page: Page
) -> None:
    async with lab.robot() as robot:
        robot.delay_s = 2.0
        slider = joint(page, "neck_yaw").locator("input")
        await expect(slider).to_be_enabled()
        await slider.focus()
        for _ in range(3):
            await page.keyboard.press("ArrowRight")
        await eventually(lambda: len(robot.moves) == 1)
        await page.locator("button.stop").click()
        await eventually(lambda: robot.stops == 2)
        assert len(robot.moves) == 1


async def test_page_lives_again_when_the_gateway_was_killed(lab: Lab, page: Page) -> None:
    async with lab.robot() as robot:
        await expect(page.locator(LIVE)).to_be_visible()
        await page.evaluate("window.sameDocument = true")
        await lab.gateway.kill()
        root = page.locator("html")
        await expect(root).to_have_attribute("data-connection", "waiting")
        await expect(page.locator("#reason")).to_contain_text("does not answer")
        await expect(page.locator(".camera")).to_have_attribute("data-state", "stale")
        await expect(page.locator(".veil")).to_contain_text("Stale: nothing new for")
        slider = joint(page, "neck_yaw").locator("input")
        await expect(slider).to_be_disabled()
        await page.locator("button.stop").click()
        await expect(page.locator(".action-error")).to_contain_text("head/stop failed")
        await screenshot(page, "gateway-away")
        await lab.gateway.start()
        began_s = time.monotonic()
        await expect(page.locator(LIVE)).to_be_visible(timeout=BACK_WITHIN_MS)
        assert time.monotonic() - began_s < BACK_WITHIN_MS / 1000
        await expect(page.locator("#reason")).to_be_hidden()
        await expect(page.locator("rect.box")).to_be_visible()
        await expect(slider).to_be_enabled()
        await slider.focus()
        await page.keyboard.press("ArrowRight")
        await eventually(lambda: len(robot.moves) == 1)
        assert await page.evaluate("window.sameDocument")


async def test_gateway_that_stands_still_is_not_shown_as_live(lab: Lab, page: Page) -> None:
    async with lab.robot():
        await expect(page.locator(LIVE)).to_be_visible()
        lab.gateway.freeze()
        await expect(page.locator(".camera")).to_have_attribute("data-state", "stale")
        await expect(page.locator("html")).not_to_have_attribute(
            "data-connection", "open", timeout=NOTICED_WITHIN_MS
        )
        await expect(page.locator("#reason")).to_contain_text("silent for")
        lab.gateway.thaw()
        await expect(page.locator(LIVE)).to_be_visible(timeout=BACK_WITHIN_MS)


async def test_gateway_that_refuses_the_token_says_so(lab: Lab, page: Page) -> None:
    await lab.gateway.kill()
    lab.gateway.token = "another-token-for-tests"
    await lab.gateway.start()
    await expect(page.locator("#reason")).to_contain_text(
        "this token is not the right one", timeout=BACK_WITHIN_MS
    )


async def test_robot_that_leaves_is_offline_with_the_reason_and_comes_back(
    lab: Lab, browser: Browser, page: Page
) -> None:
    chip = page.locator("[data-robot=vizzy] .chip")
    await expect(chip).to_have_text("offline")
    async with lab.robot():
        await expect(chip).to_have_text("online", timeout=BACK_WITHIN_MS)
        await expect(page.locator(LIVE)).to_be_visible()
    await expect(chip).to_have_text("offline")
    await expect(page.locator(".away")).to_contain_text("vizzy is offline: nobody is present")
    await expect(joint(page, "neck_yaw").locator("input")).to_be_disabled()
    await expect(page.locator(".veil")).to_contain_text("vizzy is offline")
    await screenshot(page, "robot-away")
    await page.add_init_script(WATCH_JOINTS)
    remembering = await browser.new_page()  # the gateway remembers what somebody looks at
    await remembering.goto(f"{lab.gateway.url}?token={lab.gateway.token}")
    await expect(remembering.locator(".joints")).to_have_attribute("data-state", "stale")
    await page.reload()  # what it remembers is not shown as if it were new
    await expect(page.locator(".joints")).to_have_attribute("data-state", "stale")
    await expect(page.locator(".joints .facts")).to_contain_text("Stale: nothing new for")
    await expect(joint(page, "neck_yaw").locator(".measured")).to_have_text("at 0.0°")
    assert await page.evaluate("window.jointsLived") is False
    async with lab.robot():
        await expect(page.locator(LIVE)).to_be_visible(timeout=BACK_WITHIN_MS)
        await expect(joint(page, "neck_yaw").locator("input")).to_be_enabled()


@pytest.mark.parametrize("width", [320, 390])
async def test_phone_shows_everything_without_scrolling_sideways(
    lab: Lab, browser: Browser, width: int
) -> None:
    context = await browser.new_context(
        viewport={"width": width, "height": 844},
        color_scheme="dark",
        device_scale_factor=2,
        is_mobile=True,
        has_touch=True,
    )
    page = await context.new_page()
    faults = watch(page)
    await page.goto(f"{lab.gateway.url}?token={lab.gateway.token}")
    async with lab.robot() as robot:
        await expect(page.locator("rect.box")).to_be_visible()
        await expect(joint(page, "neck_yaw").locator("input")).to_be_enabled()
        assert await page.evaluate("document.documentElement.scrollWidth") <= width
        for table in ("#streams", "#fleet"):
            inside = page.locator(f"{table} .scroll")
            assert await inside.evaluate("(box) => box.scrollWidth - box.clientWidth") <= 0
        await page.locator("button.stop").tap()
        await eventually(lambda: robot.stops == 1)
        await screenshot(page, f"phone-{width}")
    await context.close()
    assert faults == []
