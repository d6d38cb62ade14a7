// The motors of the robot: simulated ones, and the place of the real ones.
import { existsSync } from "node:fs";
import { sleep } from "mom-client/device";

const SPEED = 200; // mm/s of `drive`
const RATE = 60; // degrees/s of `turn`
/** ms after which the motors stand by themselves when they hear nothing: no program can halt them when its computer fails. */
const DEADLINE = 300;

/** Motors that take what they are told at once. */
class SimulatedMotors {
  #pose = { x: 0, y: 0, heading: 0 };
  #speed = 0;
  #rate = 0;
  #since = performance.now();
  #heard = this.#since;

  /** Goes on at so many mm/s and degrees/s. */
  setSpeed(speed, rate) {
    this.#advance();
    [this.#speed, this.#rate, this.#heard] = [speed, rate, this.#since];
  }

  /** Goes on as it does, if it has not stood by itself. */
  keepAlive() {
    this.#advance();
    this.#heard = this.#since;
  }

  /** Stands, at once, whatever it does. */
  brake() {
    this.setSpeed(0, 0);
  }

  /** Where it is: mm, mm, degrees; whole ones, since what is based on a state is refused once the position is another. */
  pose() {
    this.#advance();
    const { x, y, heading } = this.#pose;
    return { x: Math.round(x), y: Math.round(y), heading: ((Math.round(heading) % 360) + 360) % 360 };
  }

  /** What is left, in %. */
  battery() {
    return 100;
  }

  /** Whether its emergency stop is pressed: of these motors, whether there is a file `estop` here. */
  estop() {
    return existsSync("estop");
  }

  /** Drives so many mm. */
  drive(way, signal) {
    return this.#goOn(Math.sign(way) * SPEED, 0, Math.abs(way) / SPEED, signal);
  }

  /** Turns by so many degrees. */
  turn(angle, signal) {
    return this.#goOn(0, Math.sign(angle) * RATE, Math.abs(angle) / RATE, signal);
  }

  async #goOn(speed, rate, seconds, signal) {
    this.setSpeed(speed, rate);
    await sleep(seconds * 1000, signal);
    this.brake();
  }

  #advance() {
    const now = performance.now();
    const until = this.#heard + DEADLINE;
    const seconds = Math.max(0, Math.min(now, until) - this.#since) / 1000;
    this.#since = now;
    const middle = ((this.#pose.heading + (this.#rate * seconds) / 2) * Math.PI) / 180;
    this.#pose.x += this.#speed * seconds * Math.cos(middle);
    this.#pose.y += this.#speed * seconds * Math.sin(middle);
    this.#pose.heading += this.#rate * seconds;
    if (now > until) [this.#speed, this.#rate] = [0, 0];
  }
}

/** Yours: write `setSpeed`, `brake`, `keepAlive`, `pose`, `battery` and `estop`; have `drive` and `turn` end by what `pose` measures. */
class RealMotors extends SimulatedMotors {
  constructor(port) {
    super();
    throw new Error(`no driver for the motors at ${port} yet: write it in driver.mjs`);
  }
}

/** The motors at MOTORS, such as /dev/ttyUSB0; simulated ones without it. */
export const motors = () => (process.env.MOTORS ? new RealMotors(process.env.MOTORS) : new SimulatedMotors());
