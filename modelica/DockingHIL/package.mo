within ;
package DockingHIL "Hardware-in-the-loop docking simulator: robot response, contact, force sensor"
  annotation (
    version="0.1.0",
    Documentation(info="<html>
<p>Components of a one-dimensional hardware-in-the-loop docking simulator. A
position-controlled robot carries a docking rod between a front and a rear frame;
a force sensor reads the contact force. Signs and frames are fixed in
<code>SignConventions</code>; every variable carries its SI unit. The package needs
no library, not even the Modelica Standard Library.</p>
<p>Source of the equations: He, Shen, Gao, Zhang, <i>Active Compliance Control of a
Position-Controlled Industrial Robot for Simulating Space Operations</i>.</p>
</html>"));
end DockingHIL;
