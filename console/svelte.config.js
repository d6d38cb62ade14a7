export default {
  compilerOptions: {
    runes: true,
    // Each panel has its sheet in its shadow root: a strict Content-Security-Policy lets no script write styles into the page.
    css: "external",
  },
};
