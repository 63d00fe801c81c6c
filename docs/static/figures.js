// A click on a figure, or Enter, shows it as large as the window; another click, or Escape, ends it.
document.addEventListener("DOMContentLoaded", () => {
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
      document.body.append(dialog);
      dialog.showModal();
    });
  }
});
