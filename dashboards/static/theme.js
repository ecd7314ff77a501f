// Before the first paint, so that nobody who chose dark sees a white flash. The button is wired up by plain.js.
{
  const chosen = localStorage.getItem("halma-theme");
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
}
