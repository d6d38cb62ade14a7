import { define } from "../../element.svelte.js";
import Commands from "./Commands.svelte";
import css from "./commands.css?inline";

define("mom-commands", Commands, css, ["device"]);
