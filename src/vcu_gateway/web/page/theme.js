// Colours before anything is drawn: dark, light, or as the system has them.
{
  const order = ["system", "dark", "light"];
  const words = { system: "as the system has them", dark: "dark", light: "light" };
  const read = () => localStorage.getItem("theme") || "system";
  const apply = (theme) => {
    document.documentElement.dataset.theme = theme;
    const button = document.getElementById("theme");
    if (button) button.setAttribute("aria-label", `Colours: ${words[theme]}`);
  };
  apply(read());
  addEventListener("DOMContentLoaded", () => {
    apply(read());
    document.getElementById("theme").addEventListener("click", () => {
      const next = order[(order.indexOf(read()) + 1) % order.length];
      localStorage.setItem("theme", next);
      apply(next);
      dispatchEvent(new Event("themechange"));
    });
  });
}
