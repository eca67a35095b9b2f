model Bench "Sine signals of different frequencies to drive FMUs in other tools, and inputs to take what they give"
  parameter Real offset[36] = zeros(36);
  parameter Real amplitude[36] = zeros(36);
  input Real u[64];
  output Real y[36];
  output Real total;
equation
  for i in 1:36 loop
    y[i] = offset[i] + amplitude[i]*sin((40.0 + 3.0*i)*time + 0.7*i);
  end for;
  total = sum(u);
end Bench;
