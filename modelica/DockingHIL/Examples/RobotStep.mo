within DockingHIL.Examples;
model RobotStep "Step response of the robot: delay, then second order"
  parameter Real amplitude(quantity="Length", unit="m") = 0.001 "Size of the commanded step";
  DockingHIL.RobotResponse robot "Robot under test";
  output Real position(quantity="Length", unit="m") "Position of the rod tip";
equation
  robot.command = if time > 0.01 then amplitude else 0;
  position = robot.position;
  annotation (experiment(StopTime=0.05, Interval=1e-4, Tolerance=1e-8), Documentation(info="<html>
<p>Compare <code>position</code>: zero until 0.012 s, then an overshoot of 1.5 %.</p>
</html>"));
end RobotStep;
