// Colours before anything is drawn: dark, light, or as the system has them.
{
  const order = ["system", "dark", "light"];
  const words = { system: "as the system has them", dark: "dark", light: "light" };
  const light = matchMedia("(prefers-color-scheme: light)");
  const read = () => localStorage.getItem("theme") || "system";
  const apply = () => {
    const theme = read();
    document.documentElement.dataset.theme = theme !== "system" ? theme : light.matches ? "light" : "dark";
    document.getElementById("theme")?.setAttribute("aria-label", `Colours: ${words[theme]}`);
  };
  apply();
  light.addEventListener("change", apply);
  addEventListener("DOMContentLoaded", () => {
    apply();
    document.getElementById("theme").addEventListener("click", () => {
      localStorage.setItem("theme", order[(order.indexOf(read()) + 1) % order.length]);
      apply();
    });
  });
}
