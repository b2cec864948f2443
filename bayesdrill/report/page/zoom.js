(() => {
  "use strict";
  const dialog = document.querySelector("dialog");
  const large = dialog.querySelector("img");
  const sheet = dialog.querySelector(".sheet");
  for (const button of document.querySelectorAll("button.zoom")) {
    button.addEventListener("click", () => {
      const small = button.querySelector("img");
      large.src = small.src;
      large.alt = small.alt;
      dialog.showModal();
      sheet.focus();
    });
  }
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
})();
