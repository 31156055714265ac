// Files that are larger than the server takes are refused with a sentence, before they are sent.
(() => {
  const limit = () => Number(document.getElementById("upload-refusal")?.dataset.most || Infinity);
  const check = (event, files) => {
    if (!event.target.closest?.("#upload")) return;
    const refusal = document.getElementById("upload-refusal");
    const size = Array.from(files || []).reduce((sum, file) => sum + file.size, 0);
    const large = size > limit();
    refusal.textContent = large
      ? `These files have ${Math.round(size / 1048576)} MB: expected less than ${limit() / 1048576} MB, or give them on the command line.`
      : "";
    if (large) {
      event.preventDefault();
      event.stopImmediatePropagation();
    }
  };
  document.addEventListener("change", (event) => check(event, event.target.files), true);
  document.addEventListener("drop", (event) => check(event, event.dataTransfer?.files), true);
})();
