"""Drives the robot and stops it, through a hub of its own: the real programs over real sockets."""

import os
import re
import subprocess
import sys
import unittest

OPERATOR = {"MOM_USER": "operator"}


def mom(hub, *words, script=None):
    """What `mom` does, and what it says."""
    with open("operator.password", encoding="utf-8") as password:
        environment = {**os.environ, **OPERATOR, "MOM_HUB": hub, "MOM_PASSWORD": password.read().strip()}
    return subprocess.run(["mom", *words], input=script, env=environment, capture_output=True, text=True, timeout=30, check=False)


class TestRobot(unittest.TestCase):
    def setUp(self):
        hub = subprocess.Popen(["mom-broker", "--config", "hub.toml", "--listen", "127.0.0.1:0"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.addCleanup(hub.stderr.close)
        self.addCleanup(hub.wait)
        self.addCleanup(hub.kill)
        address = next(found[1] for found in (re.search(r"addresses=\[([^\],]+)", line) for line in hub.stderr) if found)
        self.hub = f"bin://{address}"
        robot = subprocess.Popen([sys.executable, "robot.py"], env={**os.environ, "MOM_HUB": f"mom://{address}"}, stdout=subprocess.PIPE)
        self.addCleanup(robot.stdout.close)
        self.addCleanup(robot.wait)
        self.addCleanup(robot.terminate)
        self.assertEqual(robot.stdout.readline(), b"newbot is ready\n")

    def run_script(self, script):
        return mom(self.hub, "run", "--channel", "/newbot/robot", "--token", "/newbot/token", "-", script=script)

    def test_it_says_what_it_can_do(self):
        card = mom(self.hub, "card", "/newbot/robot")
        self.assertIn("drive", card.stdout, card.stderr)

    def test_it_drives_and_refuses_what_is_out_of_its_range(self):
        done = self.run_script("drive 100; turn 30\ndrive -50\n")
        self.assertEqual(done.returncode, 0, done.stderr)
        refused = self.run_script("drive 5000")
        self.assertEqual(refused.returncode, 1, refused.stderr)
        self.assertIn("-2000 to 2000 mm", refused.stderr)

    def until_refused(self, words):
        """Tries to drive until it is refused in these words: it looks at its emergency stop each 150 ms."""
        refused = (self.run_script("drive 1") for _ in range(100))
        self.assertTrue(any(words in run.stdout for run in refused), words)

    def test_its_emergency_stop_holds_until_it_is_reset_and_the_stop_is_lifted(self):
        self.addCleanup(lambda: os.path.exists("estop") and os.remove("estop"))
        with open("estop", "w", encoding="utf-8"):
            self.until_refused("emergency stop")
        self.assertIn("emergency stop", mom(self.hub, "unstop", "/newbot").stdout)
        self.assertIn("emergency stop", self.run_script("drive 1").stdout, "nobody lifts it from afar")
        os.remove("estop")
        self.until_refused("is stopped")
        self.assertEqual(mom(self.hub, "unstop", "/newbot").returncode, 0)
        done = self.run_script("drive 20")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_stop_holds_until_it_is_lifted(self):
        stopped = mom(self.hub, "stop", "/newbot")
        self.assertEqual(stopped.returncode, 0, stopped.stderr)
        self.assertNotEqual(self.run_script("drive 100").returncode, 0)
        self.assertEqual(mom(self.hub, "unstop", "/newbot").returncode, 0)
        done = self.run_script("drive 20")
        self.assertEqual(done.returncode, 0, done.stderr)


if __name__ == "__main__":
    unittest.main()
