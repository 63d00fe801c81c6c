// Before the search begins: pages before the reference, and of that what users call before the rest.
const ranked = ([page, , , , score]) =>
  score / (page.includes("/api/ssac") ? 2 : page.includes("/api/") ? 4 : 1);

document.addEventListener("DOMContentLoaded", () => {
  if (window.Scorer) Scorer.score = ranked;

  // What the theme does not tell those who hear the page, and boxes that scroll, by keyboard too.
  const asides = { ".sidebar-drawer": "pages", ".toc-drawer": "on this page" };
  for (const [aside, label] of Object.entries(asides)) {
    document.querySelector(aside)?.setAttribute("aria-label", label);
  }
  for (const caption of document.querySelectorAll(".caption[role=heading]")) caption.ariaLevel = 2;
  for (const list of document.querySelectorAll("dt > dl")) list.role = "presentation";
  document.querySelector("#search-results")?.insertAdjacentHTML("beforebegin", "<h1>Search</h1>");
  for (const box of document.querySelectorAll(".table-wrapper, pre")) {
    if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
  }

  // A click on a figure, or Enter, shows it as large as the window; another, or Escape, ends it.
  for (const image of document.querySelectorAll("article img")) {
    const button = document.createElement("button");
    button.className = "figure";
    button.title = "enlarge";
    image.replaceWith(button);
    button.append(image);
    button.addEventListener("click", () => {
      const dialog = document.createElement("dialog");
      dialog.className = "figure";
      dialog.append(image.cloneNode());
      dialog.addEventListener("click", () => dialog.close());
      dialog.addEventListener("close", () => dialog.remove());
      // The page takes Escape for its own, and the dialog would stay.
      dialog.addEventListener("keydown", (event) => event.stopPropagation());
      document.body.append(dialog);
      dialog.showModal();
    });
  }
});
