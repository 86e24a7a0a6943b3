// What Sphinx leaves out for those who use a keyboard or a screen reader.
addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll(".caption[role=heading]").forEach(caption => caption.setAttribute("aria-level", "2"));
  document.querySelectorAll("pre, table.docutils").forEach(wide => { if (wide.scrollWidth > wide.clientWidth) wide.tabIndex = 0; });
});
