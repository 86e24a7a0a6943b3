"""A moving picture of a flight page, as the README shows it.

python docs/figures/flight_gif.py demo.html flight.gif


Needs Chromium with its driver, selenium and Pillow; the page comes from
``uavrl-replay policy=best env=static valleys=training task=0 output=demo.html``.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

from PIL import Image
from selenium import webdriver

ALONE = """
  for (const id of ["views", "layers", "legend", "controls"]) document.getElementById(id).style.display = "none";
  document.querySelector("header").style.display = "none";
  document.querySelector("aside").style.display = "none";
  document.querySelector("main").style.display = "block";
  document.getElementById("stage").style.height = "100vh";
  document.body.style.overflow = "hidden";
  look("chase");
  play(false);
  return Plotly.Plots.resize(document.getElementById("scene")).then(() => flight.moments);
"""


def main() -> None:
    """Draws every second step of the first flight."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(560, 340), help="pixels")
    parser.add_argument("--every", type=int, default=2, help="steps from picture to picture, each 0.1 s")
    parser.add_argument("--colours", type=int, default=96)
    args = parser.parse_args()
    options = webdriver.ChromeOptions()
    for flag in ("headless=new", "no-sandbox", "use-angle=swiftshader", "enable-unsafe-swiftshader"):
        options.add_argument(f"--{flag}")
    browser = webdriver.Chrome(options=options)
    try:
        width, height = args.size
        browser.set_script_timeout(300)
        browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
        )
        browser.get(args.page.resolve().as_uri())
        moments = browser.execute_script(ALONE)
        pictures = []
        for moment in range(0, moments, args.every):
            browser.execute_async_script(
                "const done = arguments[1]; show(arguments[0]);"
                "requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 50)));",
                moment,
            )
            picture = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")
            pictures.append(picture.quantize(args.colours, dither=Image.Dither.NONE))
    finally:
        browser.quit()
    first, *rest = pictures
    first.save(args.output, save_all=True, append_images=rest, duration=100 * args.every, loop=0, optimize=True)
    print(f"{args.output}: {len(pictures)} pictures, {args.output.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
