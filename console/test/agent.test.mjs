// The dialogue with an agent that is lent the token: the same for the one that aligns blocks and the one that calibrates cameras.
import assert from "node:assert/strict";
import { before, test } from "node:test";
import { load } from "./bundle.mjs";

let AgentTask;
let calibrate;
let factsOf;
before(async () => {
  ({ AgentTask } = await load("panels/objects/agent.svelte.ts"));
  ({ factsOf } = await load("panels/objects/servo.ts"));
  calibrate = await load("panels/calibrate/calibrate.ts");
});

/** A hub that writes down what it is asked; `says` is what the agent says. */
function task(verb, answers = {}) {
  const calls = [];
  let events;
  const hub = {
    me: { peer: "alice" },
    calls,
    notes: [],
    note: (kind, text) => hub.notes.push(`${kind} ${text}`),
    onStop: () => () => undefined,
    watch: (_what, heard) => {
      ({ events } = heard);
      return () => undefined;
    },
    call: async (call, ...args) => {
      calls.push([call, ...args]);
      if (answers[call]) return answers[call](...args);
      return call === "send" ? { id: 7, delivered: 1 } : undefined;
    },
  };
  const made = new AgentTask(hub, "/agent", verb, { done: "Done", failed: "Failed", cancelled: "Cancelled", lost: "Lost" });
  const end = made.start();
  return { made, hub, end, says: (name, content, more) => events([{ type: "message", name, content, ...more }]) };
}

const settled = () => new Promise((resolve) => setImmediate(resolve));

for (const name of ["align", "calibrate"]) {
  test(`${name}: asked, lent the token, followed to the end`, async () => {
    const { made, hub, end, says } = task(name);
    await made.begin({ camera: "x", poses: 8 }, "/robot/token", { for: 120_000 });
    assert.deepEqual(hub.calls[0], ["send", "/agent", name, { camera: "x", poses: 8 }, { echo: false }]);
    says("progress", { by: "bob", state: "accepted", agent: "it" });
    assert.equal(made.phase, "asking", "what is for others is theirs");
    says("progress", { by: "alice", state: "accepted", agent: "it" }, { history: true });
    assert.equal(made.phase, "asking", "what was said before is not an answer");
    says("progress", { by: "alice", state: "accepted", agent: "it" });
    await settled();
    assert.deepEqual(hub.calls[1], ["give", "/robot/token", "it", { for: 120_000 }]);
    says("progress", { by: "alice", state: "working", pose: 3, of: 8, text: "[3/8]" });
    assert.deepEqual([made.phase, made.busy, made.outcome], ["working", true, undefined]);
    await made.begin({}, "/robot/token", { for: 1 });
    assert.equal(hub.calls.length, 2, "one task at a time");
    says("progress", { by: "alice", state: "done", text: "well" });
    assert.deepEqual([made.phase, made.busy, made.outcome], ["over", false, "done"]);
    assert.match(hub.notes.join(), /^info .*: well$/);
    end();
  });

  test(`${name}: refusals, silence and cancelling`, async () => {
    const refused = task(name);
    await refused.made.begin({}, "/robot/token", { for: 1 });
    refused.says(`${name}-refused`, { code: 100, name: "try-later", text: "busy" }, { reference: 6 });
    assert.equal(refused.made.phase, "asking", "another's refusal");
    refused.says(`${name}-refused`, { code: 100, name: "try-later", text: "busy" }, { reference: 7 });
    assert.deepEqual([refused.made.phase, refused.made.failure.text, refused.made.outcome], ["over", "busy", undefined]);

    const nobody = task(name, { send: () => ({ id: 7, delivered: 0 }) });
    await nobody.made.begin({}, "/robot/token", { for: 1 });
    assert.equal(nobody.made.failure.code, "no-answer");

    const kept = task(name, { give: () => Promise.reject(new Error("not yours")) });
    await kept.made.begin({}, "/robot/token", { for: 1 });
    kept.says("progress", { by: "alice", state: "accepted", agent: "it" });
    await settled();
    assert.equal(kept.made.phase, "over");
    assert.deepEqual(kept.hub.calls.at(-1).slice(0, 3), ["send", "/agent", "cancel"]);
    for (const { end } of [refused, nobody, kept]) end();
  });
}

test("what they tell is read as far as it makes sense", () => {
  assert.deepEqual(factsOf({ mm: 3, pixels: 2, commands: 1 }), ["3.0 mm, 2.0 px off", "1 command"]);
  assert.deepEqual(factsOf({ mm: "3" }), []);
  const { nameOf, poseOf, timeFor } = calibrate;
  assert.deepEqual(poseOf({ pose: 3, of: 8 }), { pose: 3, of: 8 });
  for (const nonsense of [{}, { pose: 3 }, { pose: 9, of: 8 }, { pose: 0, of: 8 }, { pose: "1", of: 8 }]) assert.equal(poseOf(nonsense), undefined);
  assert.deepEqual([nameOf("/camera/x"), nameOf("/other/x"), timeFor(20), timeFor(100)], ["x", "/other/x", 120_000, 500_000]);
});
