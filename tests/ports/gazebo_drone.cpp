// A drone in Gazebo on the real library of Gazebo Transport: takes cmd_vel, publishes odometry 50 times a second.
// Started as PROGRAM MODEL; ends with its input, and prints how many commands came, the last one, and where it is.
#include <atomic>
#include <chrono>
#include <cmath>
#include <iostream>
#include <mutex>
#include <string>
#include <thread>

#include <ignition/msgs.hh>
#include <ignition/transport.hh>

namespace msgs = ignition::msgs;

int main(int, char **argv)
{
  const std::string root = std::string("/model/") + argv[1];
  ignition::transport::Node node;
  auto odometry = node.Advertise<msgs::Odometry>(root + "/odometry");
  std::mutex lock;
  msgs::Twist twist;
  long count = 0;
  std::function<void(const msgs::Twist &)> take = [&](const msgs::Twist &message) {
    std::lock_guard<std::mutex> held(lock);
    twist = message;
    ++count;
  };
  node.Subscribe(root + "/cmd_vel", take);
  std::atomic<bool> done{false};
  std::thread input([&] { for (std::string word; std::cin >> word;) {} done = true; });
  double at[3] = {0, 0, 0.5}, v[3] = {0, 0, 0}, yaw = 0.3;
  const double step = 0.02, lag = 0.2;
  for (long turn = 0; !done; ++turn)
  {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    std::lock_guard<std::mutex> held(lock);
    const double c = std::cos(yaw), s = std::sin(yaw), x = twist.linear().x(), y = twist.linear().y();
    const double wanted[3] = {x * c - y * s, x * s + y * c, twist.linear().z()};
    for (int k = 0; k < 3; ++k)
    {
      v[k] += (wanted[k] - v[k]) * step / lag;
      at[k] += v[k] * step;
    }
    yaw += twist.angular().z() * step;
    msgs::Odometry out;
    out.mutable_header()->mutable_stamp()->set_sec(turn / 50);
    out.mutable_header()->mutable_stamp()->set_nsec(turn % 50 * 20000000);
    auto *place = out.mutable_pose()->mutable_position();
    place->set_x(at[0]);
    place->set_y(at[1]);
    place->set_z(at[2]);
    out.mutable_pose()->mutable_orientation()->set_z(std::sin(yaw / 2));
    out.mutable_pose()->mutable_orientation()->set_w(std::cos(yaw / 2));
    auto *linear = out.mutable_twist()->mutable_linear();
    linear->set_x(v[0] * c + v[1] * s);
    linear->set_y(v[1] * c - v[0] * s);
    linear->set_z(v[2]);
    odometry.Publish(out);
  }
  std::cout << count << " " << twist.linear().x() << " " << twist.linear().y() << " " << twist.linear().z() << " "
            << at[0] << " " << at[1] << " " << at[2] << std::endl;
  input.join();
  return 0;
}
