import { define } from "../../element.svelte.js";
import Status from "./Status.svelte";
import css from "./status.css?inline";

define("mom-status", Status, css, ["device", "camera", "brief", "several"]);
