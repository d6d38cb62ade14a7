// The cards of the lab's devices, as `mom card --json` shows them: tests read scripts by them; test/card.e2e.mjs compares them to the lab.
const number = (name, unit, min, max) => ({ name, type: "number", unit, ...(min === undefined ? {} : { min, max }) });

export const ARM = {
  card: 1,
  name: "arm",
  does: "A robot arm with jaws",
  verbs: [
    { name: "move", does: "Moves the hand to a pose", args: [number("x", "mm", -300, 300), number("y", "mm", -300, 300), number("z", "mm", 0, 450), number("spin", "°", -180, 180), number("tilt", "°", -45, 45)], moves: true },
    { name: "by", does: "Moves the hand by so much from where it is", args: [number("dx", "mm"), number("dy", "mm"), number("dz", "mm"), number("dspin", "°"), number("dtilt", "°")], moves: true, relative: true },
    { name: "grip", does: "Moves the jaws", args: [{ name: "grip", type: "word", choices: ["open", "close"] }], moves: true, "in-place": true },
    {
      name: "jog",
      does: "Moves the hand at a velocity; another one takes its place",
      args: [number("vx", "mm/s"), number("vy", "mm/s"), number("vz", "mm/s"), number("vspin", "°/s"), number("vtilt", "°/s"), { name: "ms", type: "whole", unit: "ms", min: 1, max: 1000, default: 200 }],
      moves: true,
      velocity: true,
    },
    { name: "home", does: "Moves the hand to where it is at the start", moves: true },
    { name: "reset", does: "Puts hand, jaws and blocks back, at once: this arm is simulated", moves: true },
  ],
};

export const MOUNT = {
  card: 1,
  name: "camera-mount",
  does: "Turns the camera",
  verbs: [
    { name: "look", does: "Turns to these angles", args: [number("pan", "°", -170, 170), number("tilt", "°", -60, 30)], moves: true },
    { name: "turn", does: "Turns by so much from where it looks", args: [number("dpan", "°"), number("dtilt", "°")], moves: true, relative: true },
    { name: "home", does: "Turns to where it looks at the start", moves: true },
  ],
};

/** The cart of the tests in kit/device/src/carded.rs. */
export const CART = {
  card: 1,
  name: "cart",
  verbs: [
    { name: "go", args: [number("x", "mm", -10, 10), number("y", "mm", -10, 10)], moves: true },
    { name: "via", args: [number("x", "mm", -10, 10), number("y", "mm", -10, 10)], repeats: 2, moves: true },
    { name: "by", args: [number("way", "mm")], moves: true, relative: true },
    { name: "jog", args: [number("speed", "mm/s"), { name: "ms", type: "whole", unit: "ms", default: 200 }], moves: true, velocity: true },
    { name: "follow", args: [{ name: "leader", type: "word" }], moves: true, last: true },
    { name: "grip", args: [{ name: "grip", type: "word", choices: ["open", "close"] }], moves: true, "in-place": true },
    { name: "play", args: [{ name: "sound", type: "attachment" }], moves: false },
  ],
};

/** As large as the hub takes it, and as bad: markup, letters that turn what follows, long words, no numbers, thousands of choices. */
export function hostile({ verbs = 500, choices = 4000 } = {}) {
  const evil = '<img src=x onerror="globalThis.pwned=1">\u202e\u0007<script>globalThis.pwned=1</script>';
  const letters = (place) => place.toString(36).padStart(3, "0");
  return {
    card: 1,
    name: "hostile",
    does: evil.repeat(20),
    verbs: [
      { name: "pick", does: evil, args: [{ name: "word", type: "word", choices: Array.from({ length: choices }, (_, place) => `w${letters(place)}`) }], moves: true },
      { name: "many", args: Array.from({ length: 200 }, (_, place) => ({ name: `a${place}`, type: "number" })), moves: true },
      { name: "nan", args: [{ name: "x", type: "number", unit: evil, min: NaN, max: 1e308 }, { name: "y", type: "whole", min: -1e308 }], moves: true },
      { name: "n".repeat(64), args: [{ name: "m".repeat(64), type: "number" }], moves: true },
      { name: "constructor", moves: true },
      { name: "via", args: ["x", "y"].map((name) => ({ name, type: "whole", unit: "mm" })), repeats: 2, moves: true },
      ...Array.from({ length: verbs }, (_, place) => ({ name: `v${letters(place)}`, moves: true })),
    ],
    state: Array.from({ length: 300 }, (_, place) => ({ name: place ? `s${place}` : "__proto__", type: "word" })),
  };
}
