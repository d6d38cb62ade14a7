// The program of a device in Node: whatever ends it, its devices are halted.
import type { Obeying } from "./peer.js";

/** What it needs of the one in Node. */
interface Process {
  on(event: string, heed: (what: unknown, number: number) => void): void;
  exit(code: number): void;
}

const devices: Obeying[] = [];

/**
 * Has a device halted whatever ends its program in Node; in a page it does nothing. At SIGINT, SIGTERM and SIGHUP it halts and leaves, what
 * its verbs began may end until it has to stand, and the program ends with code 128 and the signal's number; a second signal ends it at
 * once. So it does after what nobody has caught, with code 1. The last thing is a halt, also where the program calls `process.exit`; of one
 * that gives a promise nothing is waited for then.
 */
export function runs(obeying: Obeying): Obeying {
  const { process } = globalThis as { process?: Process };
  if (!devices.length && process?.on) watch(process);
  devices.push(obeying);
  return obeying;
}

function watch(process: Process): void {
  let ends: number | undefined;
  const end = async (code: number): Promise<void> => {
    if (ends) process.exit(ends);
    ends = code;
    const late = new Promise((resolve) => setTimeout(resolve, Math.max(...devices.map(({ device }) => device.spec.stopsWithin ?? 1000))));
    await Promise.race([Promise.allSettled([...devices.map((each) => each.leave()), ...halt()]), late]);
    process.exit(code);
  };
  for (const name of ["SIGINT", "SIGTERM", "SIGHUP"]) process.on(name, (_, number) => void end(128 + number));
  for (const name of ["uncaughtException", "unhandledRejection"]) {
    process.on(name, (error) => {
      if (!ends) void end(1);
      console.error(error);
    });
  }
  process.on("exit", halt);
}

/** Has them stand, each. */
function halt(): Promise<void>[] {
  return devices.map((each) => each.halt());
}
