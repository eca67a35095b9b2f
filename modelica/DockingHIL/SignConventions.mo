within DockingHIL;
package SignConventions "Frames and signs that all components share (documentation only)"
  annotation (Documentation(info="<html>
<p>One axis x, fixed to the laboratory, pointing from the rear frame to the front frame.</p>
<ul>
<li>Position and velocity are those of the rod tip, positive towards the front frame.
The rod is free between <code>rear</code> and <code>front</code>, with
<code>rear &lt; front</code>.</li>
<li>A force is the force <b>on the rod</b>, so on the relative motion of the two satellites,
positive along +x: the front frame pushes with a negative force, the rear frame
with a positive one. Power put into the rod is force times velocity.</li>
<li>A frame only pushes: the force at the front frame is never positive, at the rear frame
never negative.</li>
<li>Penetration is zero or positive: the depth of the rod tip in whichever frame it touches.</li>
<li>A delay, a stiffness, a damping coefficient and a mass are never negative.</li>
</ul>
<p>The relative coordinate x is the position of the service satellite's rod with respect to the
target satellite's frame; its inertia is the effective mass m_e = m_s m_t/(m_s + m_t).</p>
</html>"));
end SignConventions;
