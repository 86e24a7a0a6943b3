// What Sphinx and Furo leave out for those who use a keyboard or a screen reader.
const named = (selector, name, role) => document.querySelectorAll(selector).forEach(part => {
  part.setAttribute("aria-label", name);
  if (role) part.setAttribute("role", role);
});
addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll(".caption[role=heading]").forEach(caption => caption.setAttribute("aria-level", "2"));
  named(".sidebar-drawer", "All pages");
  named(".toc-drawer", "On this page");
  named(".content-icon-container", "Source and colours", "region");
  const article = document.querySelector("article");
  if (!document.querySelector("h1")) article?.prepend(Object.assign(document.createElement("h1"), { textContent: document.title.split(" - ")[0] }));
  // A table without a header row has no empty one; a corner is no header.
  document.querySelectorAll("thead").forEach(head => head.textContent.trim() || head.querySelector("img") || head.remove());
  document.querySelectorAll("th").forEach(cell => cell.textContent.trim() || cell.querySelector("img") || cell.replaceWith(Object.assign(document.createElement("td"), { colSpan: cell.colSpan, rowSpan: cell.rowSpan })));
  // The arguments of a long signature: Sphinx makes them a list of definitions without terms.
  document.querySelectorAll("dt.sig > dl").forEach(list => {
    const lines = Object.assign(document.createElement("div"), { className: "sig-lines" });
    for (const item of [...list.children]) {
      const line = document.createElement("div");
      line.append(...item.childNodes);
      lines.append(line);
    }
    list.replaceWith(lines);
  });
  document.querySelectorAll("pre, table.docutils").forEach(wide => { if (wide.scrollWidth > wide.clientWidth) wide.tabIndex = 0; });
});
