import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { nodeOf, graft, find, ancestors, parentOf, rows, step } = await load("hub/forest.ts");

const info = (path, kind, members) => ({ path, kind, number: 1, ...(members === undefined ? {} : { members }) });

function lab() {
  const top = nodeOf(info("/", "session"), null);
  graft(top, [info("/camera", "session", 6), info("/chat", "channel", 0), info("/robot", "session", 5)]);
  const robot = top.children[2];
  graft(robot, [info("/robot/arm", "channel", 7), info("/robot/token", "token", 1)]);
  [top.open, robot.open] = [true, true];
  return top;
}
const paths = (top, filter) => rows(top, filter).map(({ node }) => node.path);

test("rows are what is open", () => {
  const top = lab();
  assert.deepEqual(paths(top), ["/", "/camera", "/chat", "/robot", "/robot/arm", "/robot/token"]);
  const last = rows(top).at(-1);
  assert.deepEqual([last.node.name, last.node.depth, last.place, last.of], ["token", 2, 2, 2]);
  top.children[2].open = false;
  assert.deepEqual(paths(top), ["/", "/camera", "/chat", "/robot"]);
});

test("a filter shows what it finds and the way there, open or not", () => {
  const top = lab();
  top.children[2].open = false;
  assert.deepEqual(paths(top, "ARM"), ["/", "/robot", "/robot/arm"]);
  assert.deepEqual(paths(top, "token"), ["/", "/robot", "/robot/token"]);
  assert.deepEqual(paths(top, "nothing"), []);
});

test("children that stay are the same nodes; another kind at the same path is another context", () => {
  const top = lab();
  const robot = top.children[2];
  const gone = graft(top, [info("/robot", "session", 9), info("/chat", "session", 0), info("/new", "token")]);
  assert.equal(top.children[0], robot);
  assert.equal(robot.members, 9);
  assert.deepEqual(gone.map(({ path }) => path), ["/camera", "/chat"]);
  assert.equal(top.children[1].kind, "session");
});

test("paths", () => {
  const top = lab();
  assert.equal(find(top, "/robot/arm").kind, "channel");
  assert.equal(find(top, "/robots"), undefined);
  assert.deepEqual(ancestors("/a/b/c"), ["/", "/a", "/a/b"]);
  assert.deepEqual(ancestors("/"), []);
  assert.deepEqual([parentOf("/a"), parentOf("/a/b")], ["/", "/a"]);
});

test("keys move as in the pattern of ARIA", () => {
  const top = lab();
  const all = rows(top);
  const go = (at, key) => step(all, at, key);
  assert.deepEqual(go("/", "ArrowDown"), { to: "/camera" });
  assert.equal(go("/", "ArrowUp"), null);
  assert.deepEqual(go("/camera", "ArrowRight"), { open: "/camera" });
  assert.deepEqual(go("/robot", "ArrowRight"), { to: "/robot/arm" });
  assert.deepEqual(go("/robot", "ArrowLeft"), { close: "/robot" });
  assert.deepEqual(go("/robot/arm", "ArrowLeft"), { to: "/robot" });
  assert.equal(go("/robot/arm", "ArrowRight"), null);
  assert.deepEqual(go("/chat", "End"), { to: "/robot/token" });
  assert.deepEqual(go("/chat", "Home"), { to: "/" });
  assert.deepEqual(go("/chat", "Enter"), { choose: "/chat" });
  assert.deepEqual(go("/chat", "c"), { to: "/camera" });
  // These are STOP, whatever has the focus.
  assert.equal(go("/chat", " "), null);
  assert.equal(go("/chat", "Escape"), null);
  assert.deepEqual(go("/gone", "ArrowDown"), { to: "/camera" });
});
