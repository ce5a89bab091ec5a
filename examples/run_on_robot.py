"""Run a policy on a robot; here, the robot is simulated.

    python examples/run_on_robot.py

Put your drives and encoders in place of `robot`. The runner stops on faults and ramps the torque
down. `fbl-gym identify run.csv` reads the log.
"""

import controllers
import fbl_gym

robot = fbl_gym.TwoLinkArmEnv("servo-nominal", action="torque")
layout, (observation, _) = robot.layout, robot.reset(seed=0)

with controllers.Runner("computed-torque-dob@tuned", "servo-nominal", send=robot.step, log="run.csv") as runner:
    for k in range(400):
        position = observation[layout["position"]]  # your encoders [rad]
        reference = observation[layout["reference_position"].start :][:6]  # your motion: q, its velocity, acceleration
        torque = runner.step(position, reference, time=k * runner.control_dt)
        observation, *_ = robot.step(torque)  # your drives [N m]
        if runner.stopped:
            break
print(runner.stopped or "the motion is over")
