// What is too wide for the window can be scrolled by keyboard. All else that Furo leaves out is in _templates and mend.py.
addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll("pre, table.docutils").forEach(wide => { if (wide.scrollWidth > wide.clientWidth) wide.tabIndex = 0; });
});
