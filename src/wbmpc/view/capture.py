"""Buttons that keep what a page shows: a picture, and a clip. Both are made by the browser, and nothing of it comes to the server."""

from __future__ import annotations

import html
import json
import re

import viser

#: Pictures per second of a clip.
RATE = 30
#: Draws the 3D picture onto paper of its own, right after the page has drawn it (its canvas is empty at any other time). ``URL`` alone is
#: the document's address in a handler of HTML.
_SCRIPT = """
(() => {
  const name = NAME, rate = RATE;
  const save = (blob, ending) => {
    const link = document.createElement("a");
    link.href = window.URL.createObjectURL(blob); link.download = `${name}.${ending}`; link.click();
    setTimeout(() => window.URL.revokeObjectURL(link.href), 60000);
  };
  const paper = document.createElement("canvas"), ink = paper.getContext("2d");
  const draw = () => {
    const scene = document.querySelector("canvas[data-engine]");
    if (paper.width !== scene.width || paper.height !== scene.height) Object.assign(paper, { width: scene.width, height: scene.height });
    ink.fillStyle = "white"; ink.fillRect(0, 0, paper.width, paper.height); ink.drawImage(scene, 0, 0);
  };
  window.wbmpcPicture = () => requestAnimationFrame(() => { draw(); paper.toBlob(blob => save(blob, "png")) });
  let recorder = null;
  window.wbmpcClip = button => {
    if (recorder) { recorder.stop(); return }
    const parts = [], again = () => { if (recorder) { draw(); requestAnimationFrame(again) } };
    draw();
    recorder = new MediaRecorder(paper.captureStream(rate), { mimeType: "video/webm" });
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
    """The buttons; files are named after ``title``."""
    name = re.sub(r"[^A-Za-z0-9.-]+", "-", title).strip("-") or "wbmpc"
    script = html.escape(_SCRIPT.replace("NAME", json.dumps(name)).replace("RATE", str(RATE)))
    buttons = (
        _BUTTON.format(action=action, label=label)
        for action, label in (("wbmpcPicture()", "Screenshot"), ("wbmpcClip(this)", "Record a clip"))
    )
    loader = f'<img src="data:image/png," alt="" style="display:none" onerror="{script}">'
    gui.add_html(f'<div style="display:flex;gap:0.5em;padding:0 0.9em 0.5em">{"".join(buttons)}</div>{loader}')
