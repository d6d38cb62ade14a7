import { define } from "../../element.svelte.js";
import dialog from "../../parts/dialog.css?inline";
import Objects from "./Objects.svelte";
import css from "./objects.css?inline";

define("mom-objects", Objects, dialog + css, ["path", "agent", "device"]);
