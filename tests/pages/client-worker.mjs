// What a page or a worker does with the client: it says something, loses its network, and goes on as if nothing had happened.
import { connect } from "/mom-client.js";

/** The first state that fits. */
async function until(items, fits) {
  for (;;) {
    const { done, value } = await items.next();
    if (done) throw new Error("it ended");
    if (value.state === "closed") throw value.error;
    if (fits(value)) return value;
  }
}

/** Gives the door over which it was resumed. */
export async function talk(name, hub, cut) {
  const client = await connect(`mom://${hub}`, { user: "alice", password: "alice" });
  const [states, chat] = [client.states(), await client.channel("/chat")];
  const events = chat.events();
  const heard = (text) => until(events, (event) => event.type === "message" && event.content === `heard ${text} by ${name}`);
  const guard = await (await client.token("/robot/token")).grab();
  await chat.sendAcknowledged("chat", `hello by ${name}`);
  await heard("hello");
  await until(states, (state) => state.state === "connected");
  await fetch(cut);
  // One on its way, and one while nothing goes.
  const receipt = chat.sendAcknowledged("chat", `this by ${name}`);
  receipt.catch(() => undefined);
  const lost = await until(states, (state) => state.state !== "connected" && state.state !== "stale");
  if (lost.state !== "resuming") throw new Error("it had to log in again");
  await chat.send("chat", `that by ${name}`);
  const { door, resumed } = await until(states, (state) => state.state === "connected");
  if (!resumed) throw new Error("it had to log in again");
  await receipt;
  await heard("this");
  await heard("that");
  const again = await (await client.token("/robot/token")).grab();
  if (guard.isLost || again.fence !== guard.fence) throw new Error("the token was lost");
  await guard.release();
  await client.close();
  return door.split(":")[0];
}

if (globalThis.WorkerGlobalScope) {
  globalThis.onmessage = async ({ data: [name, hub, cut] }) => {
    try {
      globalThis.postMessage({ door: await talk(name, hub, cut) });
    } catch (error) {
      globalThis.postMessage({ error: error.message });
    }
  };
}
