// What this page does itself: it hears who is logged in, and shows the panels then.
import { hubOf } from "./panels.js";

const who = document.getElementById("who");
const inside = document.getElementById("inside");

document.addEventListener("mom-login", ({ detail }) => {
  who.textContent = `${detail.user} is logged in (level ${detail.level}).`;
  inside.hidden = false;
});
document.addEventListener("mom-logout", () => {
  who.textContent = "Nobody is logged in.";
  inside.hidden = true;
});
document.addEventListener("mom-refused", ({ detail }) => {
  who.textContent = detail.text;
});
document.getElementById("out").addEventListener("click", () => void hubOf().close());
