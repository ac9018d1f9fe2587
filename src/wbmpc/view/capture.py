"""Buttons that save a picture or a clip of the page. The browser makes both; nothing is sent to the server."""

from __future__ import annotations

import html
import json
import re

import viser

#: Pictures per second of a clip.
RATE = 30
#: Copies the 3D picture to a second canvas right after the page has drawn it: the page's canvas is empty at any other time. ``URL`` alone
#: is the document's address in an HTML handler.
_SCRIPT = """
(() => {
  const name = NAME, rate = RATE;
  const save = (blob, ending) => {
    const link = document.createElement("a");
    link.href = window.URL.createObjectURL(blob); link.download = `${name}.${ending}`; link.click();
    setTimeout(() => window.URL.revokeObjectURL(link.href), 60000);
  };
  const copy = document.createElement("canvas"), context = copy.getContext("2d");
  const draw = () => {
    const scene = document.querySelector("canvas[data-engine]");
    if (copy.width !== scene.width || copy.height !== scene.height) Object.assign(copy, { width: scene.width, height: scene.height });
    context.fillStyle = "white"; context.fillRect(0, 0, copy.width, copy.height); context.drawImage(scene, 0, 0);
  };
  window.wbmpcPicture = () => requestAnimationFrame(() => { draw(); copy.toBlob(blob => save(blob, "png")) });
  let recorder = null;
  window.wbmpcClip = button => {
    if (recorder) { recorder.stop(); return }
    const parts = [], again = () => { if (recorder) { draw(); requestAnimationFrame(again) } };
    draw();
    recorder = new MediaRecorder(copy.captureStream(rate), { mimeType: "video/webm" });
    recorder.ondataavailable = event => parts.push(event.data);
    recorder.onstop = () => { recorder = null; button.textContent = "Record a clip"; save(new Blob(parts, { type: "video/webm" }), "webm") };
    recorder.start(1000); button.textContent = "Stop and save"; requestAnimationFrame(again);
  };
})()
"""
_BUTTON = (
    '<button type="button" onclick="{action}" style="flex:1;padding:0.4em 0.6em;font:inherit;font-size:0.85em;color:inherit;cursor:pointer;'
    'border:1px solid rgba(128,140,152,0.5);border-radius:0.3em;background:transparent">{label}</button>'
)


def add_capture(gui: viser.GuiApi, title: str) -> None:
    """Add the buttons; files are named after ``title``."""
    name = re.sub(r"[^A-Za-z0-9.-]+", "-", title).strip("-") or "wbmpc"
    script = html.escape(_SCRIPT.replace("NAME", json.dumps(name)).replace("RATE", str(RATE)))
    buttons = (
        _BUTTON.format(action=action, label=label)
        for action, label in (("wbmpcPicture()", "Screenshot"), ("wbmpcClip(this)", "Record a clip"))
    )
    loader = f'<img src="data:image/png," alt="" style="display:none" onerror="{script}">'
    gui.add_html(f'<div style="display:flex;gap:0.5em;padding:0 0.9em 0.5em">{"".join(buttons)}</div>{loader}')
