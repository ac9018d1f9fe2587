// Renders what sphinx.ext.mathjax marks, \(...\) and \[...\], with the KaTeX beside this file. Deferred scripts run before the event.
document.addEventListener("DOMContentLoaded", () => {
  for (const element of document.querySelectorAll(".math")) {
    const text = element.textContent.trim();
    katex.render(text.slice(2, -2), element, { displayMode: text.startsWith("\\["), throwOnError: false });
  }
});
