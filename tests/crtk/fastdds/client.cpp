// Client of a CRTK arm on another vendor's DDS: it enables the arm, sends 1000 positions, and prints
// a report of the received messages as one line of JSON.

#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include "crtkPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using Joints = sensor_msgs::msg::dds_::JointState_;
using State = crtk_msgs::msg::dds_::OperatingState_;
using Words = crtk_msgs::msg::dds_::StringStamped_;
using Clock = std::chrono::steady_clock;

const int SENT = 1000;

template <typename T> struct Newest : DataReaderListener {
  std::mutex lock;
  T value;
  std::atomic<int> count{0};
  void on_data_available(DataReader *reader) override {
    T next;
    SampleInfo info;
    while (reader->take_next_sample(&next, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      std::lock_guard<std::mutex> guard(lock);
      value = next;
      ++count;
    }
  }
  T get() {
    std::lock_guard<std::mutex> guard(lock);
    return value;
  }
};

std_msgs::msg::dds_::Header_ header() {
  auto now = std::chrono::system_clock::now().time_since_epoch();
  auto ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
  std_msgs::msg::dds_::Header_ made;
  made.stamp().sec(static_cast<int32_t>(ns / 1000000000));
  made.stamp().nanosec(static_cast<uint32_t>(ns % 1000000000));
  return made;
}

template <typename Reached> bool wait_for(Reached reached) {
  auto end = Clock::now() + std::chrono::seconds(10);
  while (!reached()) {
    if (Clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

int failed(const char *why) {
  std::printf("{\"failed\": \"%s\"}\n", why);
  return 1;
}

int main(int, char **arguments) {
  DomainParticipantQos quality;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.push_back("127.0.0.1");
  quality.transport().use_builtin_transports = false;
  quality.transport().user_transports.push_back(udp);
  eprosima::fastrtps::rtps::Locator_t peer;
  eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, "127.0.0.1");
  quality.wire_protocol().builtin.initialPeersList.push_back(peer);
  auto *participant = DomainParticipantFactory::get_instance()->create_participant(
      std::atoi(arguments[1]), quality);
  auto *publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
  auto *subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  TypeSupport joints(new sensor_msgs::msg::dds_::JointState_PubSubType());
  TypeSupport state(new crtk_msgs::msg::dds_::OperatingState_PubSubType());
  TypeSupport words(new crtk_msgs::msg::dds_::StringStamped_PubSubType());
  for (auto *type : {&joints, &state, &words}) type->register_type(participant);
  auto topic = [&](const char *name, TypeSupport &type) {
    return participant->create_topic(std::string("rt/PSM1/") + name, type.get_type_name(),
                                     TOPIC_QOS_DEFAULT);
  };

  DataWriterQos sure = DATAWRITER_QOS_DEFAULT;
  sure.reliability().kind = RELIABLE_RELIABILITY_QOS;
  sure.durability().kind = VOLATILE_DURABILITY_QOS;
  sure.history().depth = 10;
  DataReaderQos heard = DATAREADER_QOS_DEFAULT;
  heard.reliability().kind = RELIABLE_RELIABILITY_QOS;
  heard.history().depth = 10;
  DataReaderQos latched = heard;
  latched.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;

  Newest<Joints> measured;
  Newest<State> how;
  Newest<Words> warned;
  subscriber->create_datareader(topic("measured_js", joints), heard, &measured);
  subscriber->create_datareader(topic("operating_state", state), latched, &how);
  subscriber->create_datareader(topic("warning", words), heard, &warned);
  auto *servo = publisher->create_datawriter(topic("servo_jp", joints), sure);
  auto *command = publisher->create_datawriter(topic("state_command", words), sure);
  auto matched = [](DataWriter *writer) {
    PublicationMatchedStatus status;
    writer->get_publication_matched_status(status);
    return status.current_count > 0;
  };
  if (!wait_for([&] { return measured.count > 0 && how.count > 0; })) return failed("not heard");
  if (!wait_for([&] { return matched(servo) && matched(command); })) return failed("not found");

  Words enable;
  enable.header(header());
  enable.string_("enable");
  command->write(&enable);
  if (!wait_for([&] { return how.get().state() == "ENABLED"; })) return failed("not enabled");

  Joints wanted;
  wanted.position(measured.get().position());
  int before = measured.count, sent = 0;
  auto due = Clock::now();
  for (int i = 0; i < SENT; ++i) {
    wanted.header(header());
    wanted.position()[0] -= 0.0002;
    wanted.position()[2] += 0.00002;
    sent += servo->write(&wanted);
    due += std::chrono::milliseconds(5);
    std::this_thread::sleep_until(due);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(60));
  auto last = measured.get().position();
  int after = measured.count - before, warnings = warned.count;
  Words disable;
  disable.header(header());
  disable.string_("disable");
  command->write(&disable);
  bool off = wait_for([&] { return how.get().state() == "DISABLED"; });
  std::printf("{\"sent\": %d, \"measured\": %d, \"warnings\": %d, \"off\": %s, \"names\": %zu, "
              "\"wanted\": [%.6f, %.6f], \"there\": [%.6f, %.6f]}\n",
              sent, after, warnings, off ? "true" : "false", measured.get().name().size(),
              wanted.position()[0], wanted.position()[2], last[0], last[2]);
  std::fflush(stdout);
  std::_Exit(0);
}
